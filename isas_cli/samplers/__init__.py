"""Where to look: one distribution over all pixels of all views, one method a file."""
