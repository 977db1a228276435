"""How reasons are said: codes with values, and their English sentences."""
