"""A frame and a method as compiled code reads them, and what it asks of Python."""
