"""What stands about an arm: shapes, their distances, furniture and families of scenes."""
