"""Proposing a recipe for recordings: what `bagassets init` finds in them."""
