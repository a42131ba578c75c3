"""Machine code for the loops that take most of a cold build, compiled for this processor by llvmlite.

Each has a twin in OpenCV or numpy that gives the same bytes and is used where llvmlite is missing.
They compute in integers, or in double precision with the rounding of IEEE 754 after each operation, so that
results do not depend on the processor.
"""
