"""Sample drives: a small, physically consistent world with known ground truth, recorded in every format."""
