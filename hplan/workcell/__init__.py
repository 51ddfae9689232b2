"""Workcells: several arms, planned one by one with `hplan.planning.plan`, scheduled and certified together."""
