"""What ends a smooth motion, one event a module.

Each module has `CONSEQUENCE`, what happens then; `value(work, i, t)`, the function that falls below zero,
with its rate where there is one; `bound(work, i)` of its motion where its rate is known; and
`first(work, end)`, which finds when it first does so in the step last completed, and which one.
"""
