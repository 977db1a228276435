"""Files that softcal reads and writes, one module per kind; bad input ends in one line."""
