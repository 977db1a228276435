"""What softcal reads and writes on disk, one module per kind of file; bad input ends in one line: file, row, cure."""
