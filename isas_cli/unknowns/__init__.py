"""What is to be found: the unknowns of a scene, one file a kind."""
