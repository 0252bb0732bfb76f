"""The configuration: its schema, how it is composed, and what is wrong with it in one line."""
