"""Impacts as functions of other libraries, which compute with their derivatives. (docs/derivatives.md, 7)"""
