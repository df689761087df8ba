"""A frame and a method as compiled code reads them, and the calls of Python by compiled code."""
