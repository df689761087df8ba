"""The functions of a problem: right-hand sides in Python and in C, and events."""
