"""What a job is told, from presets and files; checked once."""
