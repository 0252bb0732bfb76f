"""What can be chosen by name: a folder a group, a file a choice."""
