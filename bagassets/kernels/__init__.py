"""Machine code for the loops that take most of a cold build, made for the processor at hand by llvmlite.

Each has a twin in OpenCV or numpy that gives the same bytes, and that is used where llvmlite is missing.
They compute in integers, or in double precision one operation after the other, as IEEE 754 defines it:
what comes out does not depend on the processor.
"""
