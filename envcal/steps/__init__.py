"""What each stage does with files: read, call the pure functions of `calibrate` and `uplift`, write.

Every step takes paths and settings, and is used by the pipeline and by the command of its name alike.
"""
