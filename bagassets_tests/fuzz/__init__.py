"""Bytes that nobody wrote, for whatever reads bytes: `make fuzz`."""
