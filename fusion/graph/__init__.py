"""The whole drive as a graph of key poses: wheels, scans matched with each other, loops, every other sensor.

What a filter cannot do: a place seen again is recognised, and the error of the loop is spread over all of it.
"""
