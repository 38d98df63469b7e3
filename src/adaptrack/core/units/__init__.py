"""Parts of a loop as units of co-simulation: numbers in, a period, numbers out."""
