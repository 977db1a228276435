"""What the registry says of itself and of quality: maintenance, studies, yields, support, trims."""
