"""Annotations: 3-D boxes with tracks in the global frame, whatever they were recorded as."""
