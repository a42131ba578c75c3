"""Pictures of recordings for people: drawn with OpenCV, the same bytes for the same input."""
