"""What every job needs: its folder, its run, its environment, patience with services."""
