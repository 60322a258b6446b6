"""The pages of the API: samples, models, health, and their description."""
