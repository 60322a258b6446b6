"""What a benchmark tells: tables, figures, files, metrics."""
