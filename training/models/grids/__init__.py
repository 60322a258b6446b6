"""Networks that read arrays of space where a serial arm would be."""
