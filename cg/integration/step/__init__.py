"""What steps are made of: frames and methods as tables, and what is asked of Python."""
