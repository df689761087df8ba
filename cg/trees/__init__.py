"""Ordered trees and the Fortran tables that are made of them."""
