"""Where the examples of a document run: a folder of their own, with the pictures that the documents name."""

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from tests.docs import ros
from tests.docs.blocks import ROOT


@pytest.fixture(scope="module")
def docs_scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder a document."""
    folder = tmp_path_factory.mktemp("docs")
    shutil.copytree(ROOT / "docs" / "images", folder / "docs" / "images")
    # No project dependencies: a camera that sees a wall, and ROS.
    sys.modules.setdefault("pyrealsense2", _realsense())
    ros.install()
    return folder


def _realsense() -> MagicMock:
    """The calls of pyrealsense2 that the documents name."""
    module = MagicMock(spec=["pipeline", "config", "stream", "format"])
    pipeline = module.pipeline.return_value
    frames, profile = pipeline.wait_for_frames.return_value, pipeline.start.return_value
    frames.get_depth_frame.return_value.get_data.return_value = np.full((480, 640), 900, np.uint16)
    video = profile.get_stream.return_value.as_video_stream_profile.return_value
    video.get_intrinsics.return_value = SimpleNamespace(fx=380.0, fy=380.0, ppx=320.0, ppy=240.0)
    profile.get_device.return_value.first_depth_sensor.return_value.get_depth_scale.return_value = 0.001
    return module
