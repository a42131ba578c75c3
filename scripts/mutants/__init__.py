"""Changes the code at random places, and runs the tests."""
