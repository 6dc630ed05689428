"""Self-calibration by evidence: which parameters of a lens the photos determine, and what it means where they do not.

A parameter is opened in a bundle adjustment of its own and believed when two witnesses agree: the adjustment's own
covariance says that the photos determine it, and tracks that the adjustment never saw fit better with it.
"""
