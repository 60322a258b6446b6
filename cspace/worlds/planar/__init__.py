"""The planar world: an arm of revolute joints among discs, seen from above in colour."""
