"""A serial arm in space among boxes and cylinders, seen by depth cameras."""
