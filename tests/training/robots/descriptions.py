"""A description of two links whose shapes need no mesh library."""

from pathlib import Path

TWO_LINKS = """<?xml version="1.0"?>
<robot name="two">
  <link name="base">
    <collision><geometry><sphere radius="0.12"/></geometry></collision>
  </link>
  <link name="upper">
    <collision><origin xyz="0 0 0.25"/><geometry><cylinder radius="0.05" length="0.3"/></geometry></collision>
  </link>
  <link name="lower">
    <collision><origin xyz="0 0 0.15"/><geometry><box size="0.04 0.06 0.1"/></geometry></collision>
  </link>
  <link name="gripper">
    <collision><origin xyz="0 0 0.02"/><geometry><sphere radius="0.03"/></geometry></collision>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="lower"/><origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/>
    <axis xyz="2 0 0"/>
  </joint>
  <joint name="mount" type="fixed">
    <parent link="lower"/><child link="gripper"/><origin xyz="0 0 0.3"/>
  </joint>
</robot>
"""
FINGER = """
  <link name="finger"/>
  <joint name="slide" type="prismatic">
    <parent link="gripper"/><child link="finger"/><axis xyz="0 1 0"/><limit lower="0" upper="1"/>
  </joint>
</robot>
"""
BRANCH = """
  <link name="second"/>
  <joint name="other" type="revolute">
    <parent link="base"/><child link="second"/><axis xyz="0 1 0"/><limit lower="0" upper="1"/>
  </joint>
</robot>
"""


def described(folder: Path, text: str = TWO_LINKS, name: str = "two.urdf") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def with_more(more: str) -> str:
    return TWO_LINKS.replace("</robot>\n", more)
