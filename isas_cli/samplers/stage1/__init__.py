"""Stage 1 of ISAS Algorithm 1: what a few paths a cell say about where to look."""
