"""The features of a step, each in one file; `engine.feature_list` lists them."""
