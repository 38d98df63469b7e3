"""Linearised loops, margins, certificates, and what a car can follow at all."""
