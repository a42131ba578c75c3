"""The nuScenes format: tables, tokens, and datasets joined from recordings."""
