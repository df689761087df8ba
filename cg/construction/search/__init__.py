"""Random search for methods: settings, starts and results."""
