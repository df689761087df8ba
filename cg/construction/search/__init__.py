"""Random search for methods: settings, starts, records and results."""
