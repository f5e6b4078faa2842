"""Settings: conversion between typed values and files, their limits, and catalogs."""
