"""Sample drives: a small world, physically consistent, recorded in every format, its truth known."""
