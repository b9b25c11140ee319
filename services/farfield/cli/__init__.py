"""The `farfield` command: one file a verb, thin."""
