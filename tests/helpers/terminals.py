"""Streams that count as terminals."""

import io


class Terminal(io.StringIO):
    def isatty(self):
        return True
