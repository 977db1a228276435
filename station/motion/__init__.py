"""Motion of the stage: bounds, safety monitors, feeding of moves, onset of contact."""
