"""The inverse problem as one object, and where its scene comes from."""
