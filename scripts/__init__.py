"""Tools of the people who build this; none is installed."""
