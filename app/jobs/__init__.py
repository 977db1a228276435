"""Jobs: long work that a page requests and another process performs."""
