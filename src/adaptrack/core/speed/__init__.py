"""The speed control: its plan, place, stops, limits, what it learns, and the faults that it finds."""
