"""Long work that a page orders and another process does."""
