"""Rules about finished artifacts: plain functions that return findings."""
