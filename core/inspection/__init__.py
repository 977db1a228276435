"""What a recording holds before anything is fitted to it: invalid samples, gaps, steps, lag of the reference."""
