"""Parts for isas that live outside it."""
