"""Rules that finished artifacts are held against: plain functions that return what they found."""
