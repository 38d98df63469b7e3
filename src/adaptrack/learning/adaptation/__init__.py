"""Schedulers that learn from driving: the method, what is learned from, and how each scheduler is made."""
