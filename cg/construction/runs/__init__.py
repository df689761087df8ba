"""Long runs, with a store for their results."""
