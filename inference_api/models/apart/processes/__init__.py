"""Child processes: their begin and end, their limits, and what is said over their pipes."""
