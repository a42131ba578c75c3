"""Recordings: finding, opening, indexing and digesting ROS 1 bags, ROS 2 bags and MCAP files."""
