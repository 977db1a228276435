"""What people read, in every language: one catalogue, and the rendering of reasons and messages."""
