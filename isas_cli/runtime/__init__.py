"""What all else stands on: Mitsuba's start, clock, Ctrl-C, errors, image files, random streams."""
