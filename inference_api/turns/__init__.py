"""Who computes when: fair turns, and a waiting room for models that are not here yet."""
