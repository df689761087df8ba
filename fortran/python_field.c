/* Calls a right-hand side that is a function in Python, as if it were one in C.
 *
 * The user data is a tuple
 *   (f, args, shape, dtype number, dim, check)
 * of the function, its further arguments, the shape of its points, the type of their entries, the
 * number of coefficients, and a function check(value, t, y) that returns them as an array, or raises
 * what is wrong with them.  It is called for all but the plainest results.
 */
#include <math.h>
#include <string.h>

#define NO_IMPORT_ARRAY /* the module imports it */
#include "fortranobject.h"
#include "shared_numbers.h"

enum { FUNCTION, ARGUMENTS, SHAPE, TYPE, COUNT, CHECK };
enum { MOST_ARGUMENTS = 32 };

/* Points are given as arrays of their own, which the function may keep but not change. */
static PyObject *make_point(PyObject *context, const double *y)
{
    PyObject *shape = PyTuple_GET_ITEM(context, SHAPE);
    int rank = (int)PyTuple_GET_SIZE(shape);
    int type = (int)PyLong_AsLong(PyTuple_GET_ITEM(context, TYPE));
    npy_intp lengths[NPY_MAXDIMS];
    for (int i = 0; i < rank; i++) {
        lengths[i] = PyLong_AsSsize_t(PyTuple_GET_ITEM(shape, i));
    }
    PyObject *point = PyArray_SimpleNew(rank, lengths, type);
    if (point != NULL) {
        memcpy(PyArray_DATA((PyArrayObject *)point), y, PyArray_NBYTES((PyArrayObject *)point));
        PyArray_CLEARFLAGS((PyArrayObject *)point, NPY_ARRAY_WRITEABLE);
    }
    return point;
}

static PyObject *call(PyObject *context, PyObject *time, PyObject *point)
{
    PyObject *extra = PyTuple_GET_ITEM(context, ARGUMENTS);
    Py_ssize_t count = PyTuple_GET_SIZE(extra);
    if (count > MOST_ARGUMENTS) {
        PyErr_Format(PyExc_TypeError, "args must have at most %d entries", (int)MOST_ARGUMENTS);
        return NULL;
    }
    PyObject *arguments[3 + MOST_ARGUMENTS] = {NULL, time, point};
    for (Py_ssize_t i = 0; i < count; i++) {
        arguments[3 + i] = PyTuple_GET_ITEM(extra, i);
    }
    return PyObject_Vectorcall(PyTuple_GET_ITEM(context, FUNCTION), arguments + 1,
                               (size_t)(2 + count) | PY_VECTORCALL_ARGUMENTS_OFFSET, NULL);
}

/* Whether a result is finite numbers in the order and the type in which they are needed */
static int is_plain(PyObject *value, Py_ssize_t count)
{
    if (!PyArray_CheckExact(value)) {
        return 0;
    }
    PyArrayObject *array = (PyArrayObject *)value;
    if (PyArray_TYPE(array) != NPY_DOUBLE || PyArray_NDIM(array) != 1
        || PyArray_DIM(array, 0) != count || !PyArray_ISCARRAY_RO(array)) {
        return 0;
    }
    const double *numbers = PyArray_DATA(array);
    double sum = 0.0;
    for (Py_ssize_t i = 0; i < count; i++) {
        sum += numbers[i];
    }
    return isfinite(sum);
}

int call_python_field(double t, const double *y, double *f, void *user_data)
{
    PyObject *context = user_data;
    int code = RAISED_IN_PYTHON;
    PyGILState_STATE lock = PyGILState_Ensure();
    PyObject *time = PyFloat_FromDouble(t);
    PyObject *point = make_point(context, y);
    PyObject *value = NULL;
    if (time != NULL && point != NULL) {
        value = call(context, time, point);
    }
    Py_ssize_t count = PyLong_AsSsize_t(PyTuple_GET_ITEM(context, COUNT));
    if (value != NULL && !is_plain(value, count)) {
        PyObject *checked = PyObject_CallFunctionObjArgs(PyTuple_GET_ITEM(context, CHECK), value,
                                                         time, point, NULL);
        Py_DECREF(value);
        value = checked;
    }
    if (value != NULL) {
        memcpy(f, PyArray_DATA((PyArrayObject *)value), (size_t)count * sizeof(double));
        code = 0;
    }
    Py_XDECREF(value);
    Py_XDECREF(point);
    Py_XDECREF(time);
    PyGILState_Release(lock);
    return code;
}
