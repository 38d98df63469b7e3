"""Contenders compared on runs that nobody trained on."""
