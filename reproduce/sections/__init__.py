"""The sections of the report: each module lists the items that it has in ``ITEMS``."""
