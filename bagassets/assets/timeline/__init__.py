"""Time lines: cutting a recording into scenes, and choosing keyframes and their readings."""
