"""Decoders: one message family per module, from rosbags message objects to readings."""
