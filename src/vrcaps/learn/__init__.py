"""Learners on images: depth, masks of lesions, classes of images; on our data and on others'.

A `Learner` says what it reads of a frame, what its network is and what it is judged by; `train`
trains any of them, `weights` writes and reads what was learned, `evaluate` and `predict` use it.
"""
