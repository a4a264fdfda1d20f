//! Embree behind a safe interface: a device, a committed scene, single rays and packets of 16.
//!
//! This module knows faces, not elements: a hit's [`Hit::face`] counts the triangles first and then
//! the quads, in the order given. Errors are checked where Embree can set them (creation and
//! commit); ray queries set none. Embree 3 and 4 are told apart only in `ffi/`.

#![allow(unsafe_code)]

mod halves;
mod packet;
mod rate;
mod ray;
mod scene;
mod sys;
#[cfg(test)]
mod tests;

pub use packet::{Hits, LANES, RayLanes, RayPacket, ShadowPacket};
pub use rate::{Queries, Width};
pub use ray::{Hit, Ray};
pub use scene::CommittedScene;

use crate::error::{Error, Result};
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char, c_void};
use std::ptr::{self, NonNull};
use std::sync::Arc;

/// An Embree device: owns the threads that build trees. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Device(Arc<DeviceHandle>);

#[derive(Debug)]
struct DeviceHandle(NonNull<sys::RTCDeviceTy>);

// SAFETY: Embree's API is thread-safe for device handles ("all API calls are thread-safe" but for
// concurrent changes of one scene or geometry, which this module makes before it shares them).
unsafe impl Send for DeviceHandle {}
// SAFETY: as for `Send`.
unsafe impl Sync for DeviceHandle {}

impl Drop for DeviceHandle {
    fn drop(&mut self) {
        // SAFETY: the handle came from `rtcNewDevice` and is released once, here.
        unsafe { sys::rtcReleaseDevice(self.0.as_ptr()) }
    }
}

thread_local! {
    /// The last message on this thread: Embree reports on the thread whose call failed.
    static MESSAGE: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Keeps the text of an error; its code is polled from the device afterwards.
unsafe extern "C" fn keep_message(_: *mut c_void, _: sys::RTCError, text: *const c_char) {
    if !text.is_null() {
        // SAFETY: Embree passes a terminated string that lives for the duration of the call.
        let text = unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned();
        // A thread that is ending has no such variable any more; nobody would read it either.
        let _ = MESSAGE.try_with(|m| m.try_borrow_mut().map(|mut m| *m = Some(text)));
    }
}

impl Device {
    /// A device that builds trees with `threads` threads; 0 means as many as the machine has.
    ///
    /// Fails where Embree does not run on this machine, or where the library that runs is not of
    /// the release whose headers this program was built with.
    pub fn new(threads: usize) -> Result<Device> {
        let config = CString::new(format!("threads={threads}")).unwrap_or_default();
        // SAFETY: `config` is a terminated string that outlives the call.
        let device = unsafe { sys::rtcNewDevice(config.as_ptr()) };
        let Some(device) = NonNull::new(device) else {
            // SAFETY: a null device asks for the error of a failed `rtcNewDevice` on this thread.
            let code = unsafe { sys::rtcGetDeviceError(ptr::null_mut()) };
            return Err(Error::Embree(format!("cannot start: {}", code_name(code))));
        };
        let device = Device(Arc::new(DeviceHandle(device)));
        // SAFETY: the handle is live, the callback is a plain function and uses no user pointer.
        unsafe { sys::rtcSetDeviceErrorFunction(device.raw(), Some(keep_message), ptr::null_mut()) };

        let built = sys::RTC_VERSION;
        let built = (u64::from(built) / 10000, u64::from(built) / 100 % 100);
        let (major, minor, _) = device.version_numbers();
        if (major, minor) != built {
            return Err(Error::Embree(format!(
                "built with the headers of version {}.{}, but version {} runs: rebuild",
                built.0,
                built.1,
                device.version()
            )));
        }
        Ok(device)
    }

    /// The version of the library that runs, for example `4.3.3`.
    pub fn version(&self) -> String {
        let (major, minor, patch) = self.version_numbers();
        format!("{major}.{minor}.{patch}")
    }

    fn version_numbers(&self) -> (u64, u64, u64) {
        let get = |property| {
            // SAFETY: the handle is live, and every version has these read-only properties.
            let value = unsafe { sys::rtcGetDeviceProperty(self.raw(), property) };
            u64::try_from(value).unwrap_or(0)
        };
        (
            get(sys::RTC_DEVICE_PROPERTY_VERSION_MAJOR),
            get(sys::RTC_DEVICE_PROPERTY_VERSION_MINOR),
            get(sys::RTC_DEVICE_PROPERTY_VERSION_PATCH),
        )
    }

    fn raw(&self) -> sys::RTCDevice {
        self.0.0.as_ptr()
    }

    /// The error, if any, that Embree set on this thread since the last check.
    fn check(&self, doing: &str) -> Result<()> {
        // SAFETY: the handle is live.
        let code = unsafe { sys::rtcGetDeviceError(self.raw()) };
        let message = MESSAGE.take();
        if code == sys::RTC_ERROR_NONE {
            return Ok(());
        }
        let message = message.filter(|m| !m.is_empty()).unwrap_or_else(|| code_name(code).into());
        Err(Error::Embree(format!("{doing}: {message}")))
    }
}

fn code_name(code: sys::RTCError) -> &'static str {
    match code {
        sys::RTC_ERROR_INVALID_ARGUMENT => "invalid argument",
        sys::RTC_ERROR_INVALID_OPERATION => "invalid operation",
        sys::RTC_ERROR_OUT_OF_MEMORY => "out of memory",
        sys::RTC_ERROR_UNSUPPORTED_CPU => "this processor is not supported",
        sys::RTC_ERROR_CANCELLED => "cancelled",
        _ => "unknown error",
    }
}
