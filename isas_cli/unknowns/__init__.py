"""What is to be found: the unknowns of a scene, one file a kind.

A new kind is a class derived from ``kind.Kind``, made known by ``registry.register``."""
