"""isas: recover scene parameters from images, and measure what each way of sampling costs."""

__version__ = "0.1.0"
