"""The arm: its joints and parts, kinematics, few spheres in place of many, the pose it waits in."""
