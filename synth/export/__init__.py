"""Files that leave the toolbox, one format per module."""
