"""Comparisons of controllers and tunings on runs that no search or training has used."""
