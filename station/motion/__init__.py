"""How the stage moves: bounds, watches, feeding, contact."""
