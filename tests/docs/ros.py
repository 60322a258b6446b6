"""Stand-ins for ROS 2, no project dependency: messages with their fields, a node that calls nobody."""

import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any


class Node:
    """A test hands messages to the callbacks and reads what was published."""

    def __init__(self, name: str) -> None:
        self.published: list[Any] = []
        self.warnings: list[str] = []

    def create_subscription(self, kind: object, topic: str, callback: object, depth: int) -> object:
        return callback

    def create_publisher(self, kind: object, topic: str, depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=self.published.append)

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self.warnings.append)


def install() -> None:
    """Makes the modules importable that the documents import, where ROS is not there."""
    messages = {
        "Image": _message(height=0, width=0, encoding="", is_bigendian=0, step=0, data=b""),
        "CameraInfo": _message(width=0, height=0, distortion_model="plumb_bob", k=[0.0] * 9, d=[0.0] * 5),
        "JointState": _message(name=[], position=[]),
        "JointTrajectory": _message(joint_names=[], points=[]),
        "JointTrajectoryPoint": _point,
    }
    for name in (
        "rclpy",
        "rclpy.node",
        "sensor_msgs",
        "sensor_msgs.msg",
        "trajectory_msgs",
        "trajectory_msgs.msg",
    ):
        module = sys.modules.setdefault(name, ModuleType(name))
        if name.endswith(".msg"):
            vars(module).update(messages)
        elif name == "rclpy.node":
            vars(module).update(Node=Node)


def _message(**fields: object) -> Callable[..., SimpleNamespace]:
    return lambda **given: SimpleNamespace(**(fields | given))


def _point(positions: list[float], velocities: list[float]) -> SimpleNamespace:
    return SimpleNamespace(
        positions=positions, velocities=velocities, time_from_start=SimpleNamespace(sec=0, nanosec=0)
    )
