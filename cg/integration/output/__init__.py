"""Solutions as they are stored, and as functions of time."""
