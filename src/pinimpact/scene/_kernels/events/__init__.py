"""Events that end a smooth motion, one per module.

Each module has `CONSEQUENCE`; `value(work, i, t)`, the function whose fall below zero is the event, and its
rate (zero if unknown); `bound(work, i)`, bounds of its motion if the rate is known; and `first(work, end)`,
which returns time and index of the first event in the last completed step.
"""
