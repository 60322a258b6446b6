"""The vocabulary and maths of the problem: pure functions and values, arrays in and arrays out."""
