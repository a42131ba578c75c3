"""Dataset formats, one folder each, and what they share: links, swaps, locks, splits, verification."""
