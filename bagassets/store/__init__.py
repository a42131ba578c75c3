"""The store: immutable artifacts named by content, and which action produced which."""
