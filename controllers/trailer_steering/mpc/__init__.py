"""Model predictive trailer steering: the trailer's own slip-aware model, steered along the hitch's measured path."""
