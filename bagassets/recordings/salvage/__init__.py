"""Reading what is damaged, in place: up to the damage, and around it.

A damaged recording is an ordinary one with a damage map, which its inventory holds, so that nothing above needs to know.
"""
