"""Print the requirements of extras of pyproject.toml: an image layer that depends on them alone."""

import pathlib
import sys
import tomllib

project = tomllib.loads(pathlib.Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
extras = [package for extra in sys.argv[1:] for package in project["optional-dependencies"][extra]]
sys.stdout.write("\n".join([*project["dependencies"], *extras, ""]))
