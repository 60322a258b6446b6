"""What planners gain, and what data cost."""
