"""What a run leaves: samples and their proof."""
