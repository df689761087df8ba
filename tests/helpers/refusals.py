"""Calls that must fail."""

import pytest


def refuses(error, message, function, /, *arguments, **options):
    """Check that a call raises an error whose message matches."""
    with pytest.raises(error, match=message):
        function(*arguments, **options)
