"""How to differentiate: estimators of the loss gradient for any pixel distribution."""
