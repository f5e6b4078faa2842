"""Training on images: depth, segmentation, classification, super-resolution and motion.

A `Learner` defines the samples, the network, the loss and the metrics of one task. `train` trains
any learner, `weights` writes and reads checkpoints, `evaluate` and `predict` use them.
"""
