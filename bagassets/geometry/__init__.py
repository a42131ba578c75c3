"""Geometry: rigid transforms, TF trees, interpolation, cameras, the WGS84 ellipsoid."""
