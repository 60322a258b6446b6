"""Starts and ends the processes of one machine, and runs the main job on them."""
