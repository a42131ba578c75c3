"""The nuScenes format: point files, tables, tokens, and datasets put together from recordings."""
