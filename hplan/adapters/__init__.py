"""The interfaces of other programs' planners, with hplan behind them."""
