"""How noisy the loss gradient is under each pixel distribution, at one fixed point.

``moments`` measures what each pixel contributes to the noise, ``best`` makes the pmf of least
variance from it, ``rounds`` estimates the gradient again and again, ``tally`` reduces the estimates
as they come, ``intervals`` says how sure results are, ``table`` and ``pictures`` show them.
"""
