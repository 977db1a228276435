"""Which devices there are, what a station file says of them, and the bench they make."""
