"""Whole studies, each a pipeline of named stages: the paper's experiment, and an adaptation."""
