"""Boxes in files beside a recording: one module per format, all read into labels."""
