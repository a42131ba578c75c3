"""Dataset formats, one folder each, and what they share: links, locks, splits, verification."""
