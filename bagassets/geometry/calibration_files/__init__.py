"""Calibration files of other tools: one module per format, `read` for whichever it is."""
