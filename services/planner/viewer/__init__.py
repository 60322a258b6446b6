"""``python -m services.planner.viewer``: an arm among obstacles in 3D, with the API's samples and plans."""
